"""What fixes say: of a place, a heading, an error."""

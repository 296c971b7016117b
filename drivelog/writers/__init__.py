"""Writers of drives, one format a file."""

"""What each departure from Spangenberg (2016) is worth."""

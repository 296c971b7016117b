"""Commands, reports and pictures: the only room with a screen."""

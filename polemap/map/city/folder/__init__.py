"""City maps in folders: a map file a district."""

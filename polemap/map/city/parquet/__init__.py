"""City maps in GeoParquet files, by row groups."""

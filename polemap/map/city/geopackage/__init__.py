"""City maps in GeoPackages, by the R-tree of their layer."""

"""The pole map as layers of a GeoPackage."""

"""Maps of whole cities: opened without reading their poles, which come a tile at a time."""

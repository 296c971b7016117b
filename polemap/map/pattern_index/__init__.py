"""Index of local pole patterns: where in a map three poles stand as three that were seen do."""

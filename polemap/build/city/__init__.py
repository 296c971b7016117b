"""Many drives at once: tasks a drive and a tile on a Dask cluster, a checkpoint a drive."""

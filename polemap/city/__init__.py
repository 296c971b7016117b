"""Many drives at once: a task a drive on a Dask cluster, a checkpoint a drive on the disk."""

"""Jobs: folders of results made once, in processes, on dask or in parts, and their progress."""

"""Jobs: folders of results made once, in processes, on dask or in parts, and what is known of them on the way."""

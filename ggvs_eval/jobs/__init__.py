"""Jobs: folders of results, computed once, in processes, on dask or in parts, and their
progress.
"""

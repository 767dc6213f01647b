"""Jobs on other machines: dask, and a sweep as commands for another scheduler."""

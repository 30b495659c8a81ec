"""Pictures by SAPIEN, rasterised or ray-traced: for stills and for transfer, in no evaluation (extra `vision`)."""

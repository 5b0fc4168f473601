"""The arm in three dimensions: MeshCat's scene of a record, or of a run that goes on, in a browser."""

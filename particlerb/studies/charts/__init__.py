"""Pictures of trajectories and of the tables of studies: the only importer of matplotlib."""

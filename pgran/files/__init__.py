"""Options in, HDF5 out, and the streams and logs of a run."""

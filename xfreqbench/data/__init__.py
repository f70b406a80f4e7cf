"""Data sets: channels and maps on disk, how they are generated, and how they are split.

In come a scene and carriers to trace, or the path of a data set; out come HDF5 files, `PasDataset`s that read them, and
`Split`s of their samples. A generation goes through `plan`, `batches`, `generate` and `writer`. `schema` says what a
file holds, `hdf5` keeps its bytes under a hash, `dataset` reads it, and `splits` says what is trained on and tested.
"""

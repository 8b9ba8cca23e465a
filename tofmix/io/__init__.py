"""Files: recordings and layers in HDF5, models in TOML. The only place that knows h5py."""

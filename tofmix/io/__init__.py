"""Files: recordings and layers in HDF5, models in TOML. No other folder imports h5py."""

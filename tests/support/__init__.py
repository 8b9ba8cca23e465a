"""What several folders of tests use: slow twins of kernels, made-up recordings, scenes with their truth, programs."""

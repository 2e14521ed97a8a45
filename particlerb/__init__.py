"""Many rigid bodies built from mass particles: closed-form free motion, Numba kernels, HDF5."""

__version__ = "0.1.0"

"""Gaussians splatted on the sphere of directions: geometry, projection, footprints and accumulation (Eqs. 4–11).

In come 3-D Gaussians with complex attributes for transmitters and carriers; power maps come out, with gradients.
Kernels compiled with Numba have plain torch twins that give the same result on any device.
"""

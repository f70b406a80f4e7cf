"""Radiance fields of RF Gaussians: projection, accumulation, conditioning and training (torch)."""

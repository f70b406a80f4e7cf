"""Benchmark of radiance-field methods that predict wireless channels at unseen carriers."""

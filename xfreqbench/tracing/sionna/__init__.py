"""Solver `sionna`: channels of any triangle mesh by Sionna RT.

In come a scene, its meshes and carriers; out go channels and paths. `tracer` is the entry. `receiver` serves
reflections and refraction with `chains` of rays shot once from the receiver; `forward` serves diffraction and diffuse
reflection with rays shot from each transmitter. `scene` is the only file that imports Sionna RT, Mitsuba and Dr.Jit,
after `llvm` has found the library that Dr.Jit compiles with; `field` wraps Sionna's path solver. `plain` is the slow
way that the others are tested against.
"""

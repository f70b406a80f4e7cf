"""Scenes: the rooms, materials, arrays and transmitters of which channels are computed.

In come the TOML file of a scene and, where it names one, a file of meshes: a Mitsuba XML (`mitsuba_xml`),
a GLB (`glb`) or an OBJ (`mesh_files`), whose shapes and materials are understood alike (`imported`). Out go a checked
`Scene` (`model`), its surfaces as triangle meshes (`meshes`) and planar facets (`facets`), the permittivity of their
materials at any carrier (`materials`), the elements of the receiver array (`array`), what sees what (`visibility`),
which meshes are rooms (`rooms`), and the possible positions of transmitters (`placement`).
"""

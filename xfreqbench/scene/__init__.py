"""Scenes: the rooms, materials, arrays and transmitters of which channels are computed.

In come the TOML file of a scene and, where it names one, a Mitsuba XML with its PLY meshes. Out go a checked `Scene`
(`model`), its surfaces as triangle meshes (`meshes`) and planar facets (`facets`), the permittivity of their
materials at any carrier (`materials`), the elements of the receiver array (`array`), what sees what (`visibility`),
and the positions where transmitters can stand (`placement`).
"""

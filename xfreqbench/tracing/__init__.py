"""Ray tracing: the channels of a scene's transmitters, by one of two solvers behind one interface.

In come a scene, its geometry, carriers and `TraceSettings`; out go the channels (T, F, M) of T transmitters at F
carriers and M array elements, or the single paths of one transmitter (`paths`). `tracer` defines the interface,
`solvers` chooses between `image` and `sionna`, and `versions` names the libraries that an answer depends on.
"""

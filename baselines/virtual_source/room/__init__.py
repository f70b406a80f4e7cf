"""The room that is made of a trained field: faces and furniture, refined at training rows, traced for predictions.

`faces` cuts planes to convex faces, `surfaces` gives these slabs of ITU-R P.2040, `refine` tries `changes` of the room,
`lengths` moves its parts, `obstacles` and `boxes` add furniture, `traced` traces it, and `render` mixes its maps with
those of the field.
"""

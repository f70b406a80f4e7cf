"""How things are drawn and written down: web page templates, Markdown tables, figures, pictures and 3D models.

It takes numbers, texts and shapes, and gives text or files; equal input gives equal bytes. It knows nothing of methods
or their scores.
"""

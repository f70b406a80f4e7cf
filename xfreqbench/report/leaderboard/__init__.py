"""The comparison of methods: run records come in, a Markdown report, its figures and a web page go out.

`boards` groups records into rows that may be ranked together, `comparison` says which row beats which, and `columns`
defines what is shown of a row. `tables` shows them as Markdown, CSV and Parquet; `report` and `page` write files.
"""

"""The comparison of methods: run records come in, a Markdown report, its figures and a web page go out.

`boards` groups records into rows that may be ranked together, `comparison` says which row beats which, and `columns`
defines what is shown of a row. `report` writes Markdown by means of `tables`, `figures` and `plots`; `page` writes HTML
by means of `gallery`.
"""

"""What a reader sees: reports and web pages made from stored results and data sets.

`leaderboard` shows how methods compare, `view` what a data set or a scene holds. Each takes records, predictions or
data sets and writes Markdown, HTML, figures or 3D models. They share `drawing` and do not import each other.
"""

"""HTML pages for light and dark screens and for paper.

`page` renders templates with their styles and scripts inside. `svg` lays out diagrams. Each other module collects the
content of one page. The template engine escapes all data and all texts of models.
"""

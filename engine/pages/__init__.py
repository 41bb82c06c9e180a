"""HTML pages for light and dark screens and for paper.

`page` renders templates. Each rendered page contains its styles and scripts. `svg` lays out diagrams. Each other module
collects the content of one page. The template engine escapes all data and all texts of models.
"""

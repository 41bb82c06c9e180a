"""Pages to look at: one self-contained HTML file each, no network, light and dark, good on paper.

`page` renders a template with the style and scripts inside; `charts` works out where marks stand; a module per page
gathers what it shows. Everything that comes from data or models is escaped by the template engine.
"""

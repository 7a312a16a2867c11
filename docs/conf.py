"""How Sphinx makes a site of the pages that docs/site.py collects in build/docs (`make docs`)."""

project = "TinyKoop"
copyright = "the TinyKoop authors, MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
html_theme = "furo"
html_title = "TinyKoop"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
copybutton_prompt_text = "$ "  # only commands are copied, not what they print
highlight_language = "none"  # of indented blocks; fenced ones name theirs
myst_heading_anchors = 4  # links to headings lead somewhere, or the build fails
autodoc_member_order = "bysource"

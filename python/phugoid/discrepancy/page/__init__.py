"""A diagnosis in words, figures and on a page."""

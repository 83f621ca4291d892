"""10.2, 10.3: the report, one HTML file that opens offline.

Modules
-------
html     the page: what stands in it and its template (template.html.j2)
words    how each indicator is calculated, in words and symbols
plots    diagrams that need no picture: layout, profile, reflectance, residuals, correlations, waveforms
photos   an image with its targets drawn, zooms, and the composite picture of a run
style    fonts with Chinese glyphs, colours, figures to data URIs
"""

from evaluator.report.html import write_report
from evaluator.report.photos import hero_picture

__all__ = ["hero_picture", "write_report"]

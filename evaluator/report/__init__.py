"""10.2, 10.3: the report, one HTML file that opens offline.

Modules
-------
html              the page (template.html.j2, page.css)
sections          what stands in its tables
pictures          which drawings stand where; made by plots, radiometry_plots, bench_plots
overlays          every image with what was found in it, and its targets enlarged
texts, plot_texts every word in Chinese and English; words: the indicators; terms: names
photos            the composite picture of a run
style             fonts with Chinese glyphs, colours, figures to data URIs
"""

from evaluator.report.html import write_report
from evaluator.report.photos import hero_picture

__all__ = ["hero_picture", "write_report"]

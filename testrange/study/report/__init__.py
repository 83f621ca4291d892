"""What a study shows: figures as PNG and SVG, sentences, study.html (page.html.j2), the lines of the command."""

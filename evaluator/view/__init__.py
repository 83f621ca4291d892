"""view.html: the range in 3D, one file that opens from disk and asks nobody for anything.

Modules
-------
page     the scene as JSON; template (page.html.j2), style and scripts put into one file
points   which returns are shown, with their places, reflectance and error
pack     points as few bytes
terrain  the ground as a grid
solids   targets as bodies
flight   trajectories and camera poses
facts    what is said of a target or an image
words    texts in both languages
colours  scales
maths.js draw.js scene.js orbit.js view.js    the page's own program, in that order
"""

from evaluator.view.model import TruthErrors
from evaluator.view.page import write_view

__all__ = ["TruthErrors", "write_view"]

"""`testrange plan`: what a campaign will be like, before anything is flown or rendered.

Modules
-------
model      the plan: figures and rows
campaign   the order: paper, predictions, the evaluator's conformity rows on them
rehearsal  the campaign on paper, in memory
beams      pulses cast at the targets along the planned path
benches    rows that the set-up of chessboard and ranging line decides
light      GSD, blur, overlap, brightness; marks in images
physics    rows that no clause asks for
volume     bytes on the disk
remedies   the way out of a failing row
words      Chinese of the plan's own rows
show       tables and JSON
"""

from testrange.plan.campaign import plan_campaign
from testrange.plan.model import Plan, PlanRow
from testrange.plan.show import plan_block, print_plan

__all__ = ["Plan", "PlanRow", "plan_block", "plan_campaign", "print_plan"]

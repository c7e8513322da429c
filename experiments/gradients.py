"""Distances whose walls, goals or stored values change: right, fast, and good for layouts, calibration and curricula.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others as
they are. The file of a section in ``experiments/differentiating/`` says what it does.
"""

from experiments._runner import Section, run
from experiments.differentiating import _calibrate, _camar, _differences, _exact, _generate, _layout, _speed

SECTIONS = {
    "exact": Section(_exact.measure),
    "differences": Section(_differences.measure),
    "speed": Section(_speed.measure),
    "layout": Section(_layout.measure),
    "calibrate": Section(_calibrate.measure),
    "generate": Section(_generate.measure),
    "camar": Section(_camar.measure),
}

if __name__ == "__main__":
    run("gradients", __doc__, SECTIONS)

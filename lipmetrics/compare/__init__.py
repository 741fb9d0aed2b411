"""Takes against takes: alignment in time, distances, averages, recognition, and parts of movements."""

from lipmetrics.compare.alignment import Alignment, align
from lipmetrics.compare.averages import Average, average, averages, load_average
from lipmetrics.compare.classes import RECOGNITION_BAND, Classification, classify, classify_all, confusion
from lipmetrics.compare.curves import Curve, as_curve
from lipmetrics.compare.distances import L2, Hausdorff, aligned_hausdorff, aligned_l2, hausdorff, l2
from lipmetrics.compare.pairs import Pairs, pairs
from lipmetrics.compare.phases import Region, carry, compare_gradients, gradients, propose_phases
from lipmetrics.compare.warping import BAND, COST, dtw_path

__all__ = [
    "BAND",
    "COST",
    "L2",
    "RECOGNITION_BAND",
    "Alignment",
    "Average",
    "Classification",
    "Curve",
    "Hausdorff",
    "Pairs",
    "Region",
    "align",
    "aligned_hausdorff",
    "aligned_l2",
    "as_curve",
    "average",
    "averages",
    "carry",
    "classify",
    "classify_all",
    "compare_gradients",
    "confusion",
    "dtw_path",
    "gradients",
    "hausdorff",
    "l2",
    "load_average",
    "pairs",
    "propose_phases",
]

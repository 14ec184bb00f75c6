"""Speed against accuracy of every reducer: measured in one run, compared, drawn, explored."""

from analysis.chart.chart import Chart, read_json
from analysis.chart.compute import FULL, QUICK, Effort, compute_chart
from analysis.chart.pareto import dominates, find_front
from analysis.chart.write import write_chart

__all__ = [
    "FULL",
    "QUICK",
    "Chart",
    "Effort",
    "compute_chart",
    "dominates",
    "find_front",
    "read_json",
    "write_chart",
]

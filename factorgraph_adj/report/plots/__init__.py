"""Figures of an adjustment; the extra ``plot`` (matplotlib) is required."""

from ..set_aside import set_aside
from .displacements import plot_displacements
from .growth import plot_growth
from .histogram import plot_w
from .images import plot_mean_photo, plot_photo_residuals, plot_photos
from .network import plot_network
from .save import save_plots
from .statistics import plot_qq, plot_redundancy

__all__ = [
    "plot_displacements",
    "plot_growth",
    "plot_mean_photo",
    "plot_network",
    "plot_photo_residuals",
    "plot_photos",
    "plot_qq",
    "plot_redundancy",
    "plot_w",
    "save_plots",
    "set_aside",
]

"""Figures of an adjustment; the extra ``plot`` (matplotlib) is required."""

from ..rejected_observations import set_aside
from .displacements import plot_displacements
from .figure_files import save_plots
from .network_plan import plot_network
from .photo_figures import plot_mean_photo, plot_photo_residuals, plot_photos
from .precision_growth import plot_growth
from .reliability_figures import plot_qq, plot_redundancy, plot_w

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

"""Plane sweep: disparity of every pixel from all cameras of a frame, without an initial estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scenetruth.estimators.method_settings import PlaneSweepSettings
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put, assemble_estimate, blank_estimate, put_estimate
from scenetruth.schema.validity import complete_validity

if TYPE_CHECKING:
    import xarray as xr

__all__ = []


class _PlaneSweep(StreamingMethod):
    """Depth by plane sweep: census costs of all cameras with semi-global aggregation.

    References
    ----------
    R. Zabih and J. Woodfill: Non-parametric Local Transforms for Computing Visual Correspondence. European Conference
    on Computer Vision, 1994. H. Hirschmüller: Stereo Processing by Semiglobal Matching and Mutual Information. IEEE
    Transactions on Pattern Analysis and Machine Intelligence 30, 2008.
    """

    name = "plane_sweep"
    settings = PlaneSweepSettings
    gives: frozenset[str] = frozenset({"depth", "disparity"})
    needs = Needs(cameras=2)

    def blank(self, recording: xr.Dataset, settings: PlaneSweepSettings) -> xr.Dataset:
        return blank_estimate(["disparity"], recording=recording, t=recording["t"].values)

    def fill(
        self, recording: xr.Dataset, settings: PlaneSweepSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        from scenetruth.estimators.plane_sweep.disparity_sweep import estimate_disparities

        times = recording["t"].values
        for place, (disparity, reason) in enumerate(estimate_disparities(recording, settings, progress)):
            found = assemble_estimate(recording=recording, disparity=disparity, t=times[place])
            stated = found["invalid_reason"].copy(data=reason[None])
            put_estimate(complete_validity(found.assign(invalid_reason=stated), recording), place, put)
        return {}


METHOD = _PlaneSweep()

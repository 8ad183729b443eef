"""Text of a project of STAR*NET, with rows of other values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

STAR_NET_PROJECT = """\
*STAR*NET 3
#
# 13.0.2.5829
[Adjustment]
#
adjustment_type                3D
linear_units                   Meters
angle_output_units             DMS
local_or_grid_adjustment       0
coordinate_system_name         UTM83-19
project_elevation              0.000000000000000
local_default_datum            1
common_datum_reduction         0.0000000000
scale_factor                   1.0000000000
geoid_height                   0.000000
vert_defl_north                0.000000
vert_defl_east                 0.000000
coordinate_order               EN
angle_station_order            At-From-To
3D_input_mode                  Slope/Zenith
index_of_refraction            0.0700000000
earth_radius_meters            6372000.0000000000
converge_limit                 0.0100000000
fixed_linear_std_err           1.000000000000000e-05
fixed_angular_std_err          1.000000000000000e-02
longitude_convention           0
geoid_modeling                 0
vert_defl_modeling             0
gps_factor                     0
gps_factor_alt_vert            0
gps_factor_horiz               1.000000
gps_factor_vert                1.000000
gps_centering                  0
gps_transformations            0
#
[Listing]
print_input_file               0
#
[Instrument]
#
distance_std_err               0.0010000000
edm_ppm                        1.5000000000
angle_std_err                  1.4140000000
direction_std_err              1.0000000000
azimuth_std_err                1.4140000000
zenith_std_err                 1.2000000000
delta_elev_std_err             0.0152400000
delta_elev_ppm                 0.0000000000
instrument_centering_error     0.0007500000
target_centering_error         0.0008000000
vertical_centering_error       0.0005000000
level_section_type             LENGTH
level_std_err                  0.000047434164903
#
[InstrumentLibrary]
#
instrument_name                S 9
distance_std_err               0.0008000000
edm_ppm                        1.0000000000
angle_std_err                  0.7071067810
direction_std_err              0.5000000000
azimuth_std_err                0.7071067810
zenith_std_err                 0.6000000000
delta_elev_std_err             0.0152400000
delta_elev_ppm                 0.0000000000
instrument_centering_error     0.0002000000
target_centering_error         0.0003000000
vertical_centering_error       0.0004000000
#
instrument_name                SX12
distance_std_err               0.0020000000
edm_ppm                        2.0000000000
angle_std_err                  2.0000000000
direction_std_err              2.0000000000
azimuth_std_err                2.0000000000
zenith_std_err                 2.5000000000
delta_elev_std_err             0.0152400000
delta_elev_ppm                 0.0000000000
instrument_centering_error     0.0010000000
target_centering_error         0.0010000000
vertical_centering_error       0.0010000000
#
[DataFileList]
#
0 "old.dat"
3 "first day.dat"
1 "second.dat"
#
[USER]
username
"""
"""A local project of two instruments and two data files."""


def star_net_project(
    files: Sequence[str], library: Mapping[str, Mapping[str, str]] | None = None, **rows: str
) -> str:
    """Return a project with other data files, instruments of the library, and values of rows."""
    text = STAR_NET_PROJECT
    head, _, rest = text.partition("[InstrumentLibrary]")
    for key, value in rows.items():
        head, count = re.subn(rf"(?m)^({key} +).*$", rf"\g<1>{value}", head)
        assert count == 1, key
    of_sx12 = rest.partition("instrument_name                SX12\n")[2].partition("#")[0]
    instruments = ""
    for name, errors in (library or {}).items():
        own = of_sx12
        for key, value in errors.items():
            own, count = re.subn(rf"(?m)^({key} +).*$", rf"\g<1>{value}", own)
            assert count == 1, key
        instruments += f"instrument_name {name}\n{own}"
    used = "".join(f'3 "{name}"\n' for name in files)
    return f"{head}[InstrumentLibrary]\n{instruments}[DataFileList]\n{used}"

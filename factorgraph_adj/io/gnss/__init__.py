"""Files of GNSS: SINEX, DynaML of DynAdjust, GVX of the National Geodetic Survey."""

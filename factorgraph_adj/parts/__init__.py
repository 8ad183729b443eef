"""Helmert blocks: a network in parts, each of which a process of its own reads and eliminates.

The normal equations of each part are reduced to its junctions, the unknowns that other parts have
too (Helmert 1880; Wolf 1978). The root adds the reduced equations of all parts and solves them;
then each part finds its own unknowns. With i for the interior of a part and j for its junctions,

    S = N_jj − N_ji N_ii⁻¹ N_ij,   s = g_j − N_ji N_ii⁻¹ g_i,
    ΣS dx_j = −Σs,   N_ii dx_i = −g_i − N_ij dx_j.

The result is that of the whole network, and no process holds more than one part at a time.
"""

"""The replication of Kapitaniak et al. (Chaos 22, 047504, 2012): each of its statements beside our result.

`replication` runs every part and writes the page; each part computes one subject (moments of inertia and Fig. 2, Fig. 5,
Fig. 6, odds, Lyapunov exponents, filmed bounces) and returns `Result`s with a verdict. `diethrow paper` runs it.
"""

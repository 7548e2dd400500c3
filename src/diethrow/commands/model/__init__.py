"""Commands that simulate: one throw, odds of the faces, basins of attraction, Lyapunov exponents, and a throw as a clip.

`simulated_throw` is the command throw, `face_odds` odds, `basin_maps` basins, `lyapunov_exponents` lyapunov, and
`filmed_throw` film, with its settings and presets in `film_settings` and `film_presets`. Each has a function that anyone can
call with a plan and an output folder, the table that it writes as JSON, and a summary for the terminal; the command line adds
options. `compiled_kernels` is the command warm-up, which compiles what all commands need.
"""

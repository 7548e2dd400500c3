"""Commands on clips and tracks.

`calibrate.calibrate_camera` and `check.check_clip` come before tracking. `analyze.analyze` runs the whole analysis,
`track.track_only` and `fit.fit_track` its two stages, `joint_fit.fit_tracks` the joint fit of several tracks.
`predict.predict_tracks` predicts throws, `batch.run_batch` analyses many scenes, and `trade.trade` measures speed against
accuracy.
"""

"""Every file that the program reads from a user or writes for one, apart from footage and pictures.

Scene and throw files (`scene`, `plan`, checked by `settings`), the columns of tracks and bounces (`throw_records`), what
tracking knows beside the poses (`measured_throw`), the fit (`fit_records`), `provenance`, how any table is written
(`csv_and_json`), and the folders that they lie in (`outputs`, `work_file`). Commands call these modules directly.
"""

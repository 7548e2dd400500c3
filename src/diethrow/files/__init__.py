"""Every file that the program reads from a user or writes for one, apart from footage and pictures.

Scene and throw files (`scene`, `plan`, checked by `settings`), the records of a result (`tables`, `throw_records`, `fit_records`,
`provenance`, `truth`), and the folders that they lie in (`outputs`, `work_file`). Commands call these modules directly.
"""

"""Studies: who is measured on what, in processes of their own, remembered and told.

Data flows `shapes`, `recipes` and the contenders of a study -> `study.run`, which measures in the
processes of `worker` what the `store` does not hold yet -> tables and figures, by `report` and
`figures`. A module of each study has its command, for `run.py`.
"""

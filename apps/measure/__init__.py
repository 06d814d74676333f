"""Measuring: who is measured on what, in processes of their own, remembered and told.

Data flows `shapes`, `recipes` and the contenders of a study -> `study.run`, which measures in the
processes of `worker` what the `store` does not hold yet -> `tables`, `figures` and `machine` for
the report.
Each study is a file: `eigensolvers`, `geodesics`, `explorer`, `network`, `matching`.
"""

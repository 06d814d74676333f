"""What embeddings are worth to classifiers and to segmenters, on labelled sets of shapes.

`classification` is told by `classify`, `segmentation` by `segment`.
"""

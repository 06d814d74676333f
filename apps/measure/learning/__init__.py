"""What embeddings are worth to classifiers and to segmenters, on labelled sets of shapes.

Read `classification` first, or `segmentation`.
"""

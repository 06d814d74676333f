"""One module for each file format: ``read(path)`` gives arrays, ``write(geometry, path)`` a file.

Readers keep the order of vertices and faces, compare every announced count with what the file
holds, and raise `InvalidInputError` without the path, which `geometry.read` puts in front.
"""

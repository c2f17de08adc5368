"""Follow special points of families as curves in the plane of two parameters.

Folds and flips are followed as roots of one system. Ends and other points are followed by secants.
"""

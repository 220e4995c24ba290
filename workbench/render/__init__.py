"""Pictures and files of results, from values and a path.

Functions `draw_...` write a picture to `path`, PNG or SVG, and return the path. `sections` and `solids` draw fields and
shapes, `plots` draws curves, `vtu` writes for ParaView. Only the command line and the examples import this package.
"""

"""Pictures and files for the eye. Everything here takes values and a path.

Only the command line and the examples import it: `sections` and `solids` draw fields and shapes, `plots` draws curves,
`vtu` writes for ParaView.
"""

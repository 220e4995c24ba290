"""Pictures and files for the eye. Everything here takes values and a path, and nothing but the command line and the
examples imports it: `sections` and `solids` draw fields and shapes, `plots` draws curves, `vtu` writes for ParaView."""

"""The live view: a chip with adjustable parameters, spectrum and fields.

The session (`workbench.app.session`) has the present values and answers from reduced models, which grow in the
background; it does not depend on pages, and is the interface for tests and notebooks. The page (`workbench.app.page`)
is served to this computer alone (`workbench.app.guard`) and never waits: long work runs in the background and reports
its progress (`workbench.app.background`).
"""

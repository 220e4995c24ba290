"""The live view: a chip whose lengths and constants are moved by hand, with its spectrum and its fields beside.

The session (`workbench.app.session`) holds the present numbers and answers from reduced models, which grow while it is
asked; it knows nothing of pages, and is what tests and notebooks use. The page (`workbench.app.page`) is served to this
computer alone (`workbench.app.guard`) and never waits: what takes long is done in the background and says how far it is
(`workbench.app.background`).
"""

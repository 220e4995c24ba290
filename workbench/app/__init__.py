"""The live view: a chip whose lengths and constants are moved by hand, with its spectrum and its fields beside.

The session (`workbench.app.session`) holds the present numbers and answers from reduced models, which grow meanwhile;
it knows nothing of pages, and is the interface for tests and notebooks. The page (`workbench.app.page`) is served to
this computer alone (`workbench.app.guard`) and never waits: long work is done in the background and reports its
progress (`workbench.app.background`).
"""

"""Results as tables, JSON records and pages; one module a product."""

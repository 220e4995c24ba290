"""Results as tables, as JSON records, and as report.html, one file that opens offline: one module a product."""

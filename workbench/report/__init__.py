"""What ``-o DIR`` receives: JSON records, and report.html, one file that opens offline."""

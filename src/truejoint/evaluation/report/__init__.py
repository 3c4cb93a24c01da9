"""The HTML report of an evaluation, and the page of several models side by side."""

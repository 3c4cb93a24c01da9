"""Studies on virtual RAVEN-II arms: every table and figure of peng2024."""

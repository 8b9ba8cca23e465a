"""A mutation study: small faults put into the package, and the share of them that each suite of tests finds."""

"""Parts of the stability atlas that the tests use as well."""

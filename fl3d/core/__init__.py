"""What every room stands on: errors, files, digests, leases, provenance and records."""

"""Certificate of a design: `certify.certify`."""

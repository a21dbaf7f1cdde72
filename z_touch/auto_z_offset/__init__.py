"""[auto_z_offset]: the piezo sensor below the bed against the inductive probe."""

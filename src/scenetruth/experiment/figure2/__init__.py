"""The paper's figure 2: errors of U_X, U_Z and Z over their size."""

ALTER VIEW robot_state SET (security_invoker = true);
ALTER VIEW bar_state SET (security_invoker = true);
GRANT SELECT ON robot_state, bar_state TO dbbd_cell, dbbd_viewer, dbbd_worker;

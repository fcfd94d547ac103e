-- A cell writes its own runs and sees its own; a viewer sees all and writes nothing; a worker sees all and writes
-- results. Nobody but the owner of the tables changes or deletes a run, a file or a result.
GRANT USAGE ON SCHEMA dbbd TO dbbd_cell, dbbd_viewer, dbbd_worker;
GRANT SELECT ON ALL TABLES IN SCHEMA dbbd TO dbbd_cell, dbbd_viewer, dbbd_worker;
GRANT INSERT (sha256, pushed_at, cell, robot, type, bar, certificate, certified_on, operator, measured, plan, bytes,
              decision, provenance) ON run TO dbbd_cell;
GRANT INSERT ON run_file TO dbbd_cell;
GRANT INSERT (run, settings, version) ON job TO dbbd_cell, dbbd_worker;
GRANT UPDATE (state, attempts, worker, lease_until, code, message) ON job TO dbbd_worker;
GRANT INSERT ON result, result_file TO dbbd_worker;

-- A view shows what its reader may see.
ALTER VIEW history SET (security_invoker = true);
ALTER VIEW robot SET (security_invoker = true);
ALTER VIEW bar SET (security_invoker = true);
ALTER VIEW queue SET (security_invoker = true);

ALTER TABLE run ENABLE ROW LEVEL SECURITY;
ALTER TABLE run_file ENABLE ROW LEVEL SECURITY;
ALTER TABLE job ENABLE ROW LEVEL SECURITY;
ALTER TABLE result ENABLE ROW LEVEL SECURITY;
ALTER TABLE result_file ENABLE ROW LEVEL SECURITY;

CREATE POLICY all_read ON run FOR SELECT TO dbbd_viewer, dbbd_worker USING (true);
CREATE POLICY all_read ON run_file FOR SELECT TO dbbd_viewer, dbbd_worker USING (true);
CREATE POLICY all_read ON job FOR SELECT TO dbbd_viewer, dbbd_worker USING (true);
CREATE POLICY all_read ON result FOR SELECT TO dbbd_viewer, dbbd_worker USING (true);
CREATE POLICY all_read ON result_file FOR SELECT TO dbbd_viewer, dbbd_worker USING (true);

CREATE POLICY own_read ON run FOR SELECT TO dbbd_cell USING (owner = current_user);
CREATE POLICY own_write ON run FOR INSERT TO dbbd_cell WITH CHECK (owner = current_user);
-- The rows of `run` that these ask for are those that the cell sees: its own.
CREATE POLICY own_read ON run_file FOR SELECT TO dbbd_cell USING (run IN (SELECT sha256 FROM run));
CREATE POLICY own_write ON run_file FOR INSERT TO dbbd_cell WITH CHECK (run IN (SELECT sha256 FROM run));
CREATE POLICY own_read ON job FOR SELECT TO dbbd_cell USING (run IN (SELECT sha256 FROM run));
CREATE POLICY own_write ON job FOR INSERT TO dbbd_cell WITH CHECK (run IN (SELECT sha256 FROM run));
CREATE POLICY own_read ON result FOR SELECT TO dbbd_cell USING (run IN (SELECT sha256 FROM run));
CREATE POLICY own_read ON result_file FOR SELECT TO dbbd_cell USING (run IN (SELECT sha256 FROM run));

CREATE POLICY work ON job FOR INSERT TO dbbd_worker WITH CHECK (true);
CREATE POLICY progress ON job FOR UPDATE TO dbbd_worker USING (true) WITH CHECK (true);
CREATE POLICY work ON result FOR INSERT TO dbbd_worker WITH CHECK (true);
CREATE POLICY work ON result_file FOR INSERT TO dbbd_worker WITH CHECK (true);

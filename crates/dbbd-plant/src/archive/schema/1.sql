-- A run, known by the SHA-256 of its capture. Times are ms since the Unix epoch; `measured` is UTC, as the capture has it.
CREATE TABLE run (
    sha256 TEXT PRIMARY KEY,
    owner TEXT NOT NULL DEFAULT ({user}),
    pushed_at BIGINT NOT NULL,
    cell TEXT NOT NULL,
    robot TEXT NOT NULL,
    type TEXT NOT NULL,
    bar TEXT NOT NULL,
    certificate TEXT,
    certified_on TEXT,
    operator TEXT,
    measured TEXT NOT NULL,
    plan TEXT,
    bytes BIGINT NOT NULL,
    decision TEXT,
    provenance TEXT NOT NULL
);
CREATE INDEX run_robot ON run (robot, measured);
CREATE INDEX run_bar ON run (bar, measured);
CREATE INDEX run_cell ON run (cell, measured);
CREATE INDEX run_measured ON run (measured);

-- Every file that was pushed with a run, and every version of it.
CREATE TABLE run_file (
    run TEXT NOT NULL REFERENCES run,
    name TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    bytes BIGINT NOT NULL,
    pushed_at BIGINT NOT NULL,
    PRIMARY KEY (run, name, sha256)
);

-- Work: a run to identify with these settings, by this version of dbbd or, where it is empty, by any.
CREATE TABLE job (
    run TEXT NOT NULL REFERENCES run,
    settings TEXT NOT NULL,
    version TEXT NOT NULL,
    state TEXT NOT NULL DEFAULT 'waiting' CHECK (state IN ('waiting', 'running', 'done', 'failed')),
    attempts BIGINT NOT NULL DEFAULT 0,
    worker TEXT,
    lease_until BIGINT NOT NULL DEFAULT 0,
    asked_at BIGINT NOT NULL DEFAULT ({now}),
    code TEXT,
    message TEXT,
    PRIMARY KEY (run, settings, version)
);
CREATE INDEX job_open ON job (state, asked_at);

-- What an identification found. Lengths in mm; `posterior` is JSON: the parameters, their corrections, the root of their
-- covariance, and the standard deviations of the prior.
CREATE TABLE result (
    run TEXT NOT NULL REFERENCES run,
    settings TEXT NOT NULL,
    version TEXT NOT NULL,
    made_at BIGINT NOT NULL,
    worker TEXT NOT NULL,
    has_warnings BIGINT NOT NULL,
    lengths BIGINT NOT NULL,
    sigma_mm DOUBLE PRECISION,
    rms_before_mm DOUBLE PRECISION,
    rms_after_mm DOUBLE PRECISION,
    error_nominal_mm DOUBLE PRECISION,
    error_identified_mm DOUBLE PRECISION,
    posterior TEXT,
    PRIMARY KEY (run, settings, version)
);

CREATE TABLE result_file (
    run TEXT NOT NULL,
    settings TEXT NOT NULL,
    version TEXT NOT NULL,
    name TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    bytes BIGINT NOT NULL,
    PRIMARY KEY (run, settings, version, name),
    FOREIGN KEY (run, settings, version) REFERENCES result
);

-- For dashboards: a line a result, with the run that it belongs to.
CREATE VIEW history AS
SELECT run.sha256, run.cell, run.robot, run.type, run.bar, run.operator, run.measured, run.decision, run.bytes,
       result.settings, result.version, result.has_warnings, result.lengths, result.sigma_mm, result.rms_before_mm,
       result.rms_after_mm, result.error_nominal_mm, result.error_identified_mm, result.made_at
FROM run LEFT JOIN result ON result.run = run.sha256;

-- A line a robot: how often, when last.
CREATE VIEW robot AS
SELECT robot, min(type) AS type, count(*) AS runs, min(measured) AS first, max(measured) AS last
FROM run GROUP BY robot;

-- A line a bar.
CREATE VIEW bar AS
SELECT bar, max(certificate) AS certificate, max(certified_on) AS certified_on, count(*) AS runs,
       count(DISTINCT cell) AS cells, min(measured) AS first, max(measured) AS last
FROM run GROUP BY bar;

-- The queue by state.
CREATE VIEW queue AS SELECT state, count(*) AS jobs FROM job GROUP BY state;

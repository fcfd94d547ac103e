-- What the pages of the plant ask: the last run and the last check of each robot, the last run of each bar. The names are
-- found one after the other by the index, so that the time grows with the robots and not with the runs.
CREATE INDEX run_decided ON run (robot, measured) WHERE decision IS NOT NULL;

CREATE VIEW robot_state AS
WITH RECURSIVE known (robot) AS (
    SELECT min(robot) FROM run
    UNION ALL
    SELECT (SELECT min(next.robot) FROM run AS next WHERE next.robot > known.robot)
    FROM known WHERE known.robot IS NOT NULL
), newest AS (
    SELECT known.robot,
           (SELECT one.sha256 FROM run AS one WHERE one.robot = known.robot
            ORDER BY one.measured DESC LIMIT 1) AS last_run,
           (SELECT one.sha256 FROM run AS one WHERE one.robot = known.robot AND one.decision IS NOT NULL
            ORDER BY one.measured DESC LIMIT 1) AS check_run
    FROM known WHERE known.robot IS NOT NULL
)
SELECT newest.robot, last.type, last.sha256 AS last_run, last.measured AS last, checked.sha256 AS check_run,
       checked.measured AS checked, checked.decision
FROM newest JOIN run AS last ON last.sha256 = newest.last_run
            LEFT JOIN run AS checked ON checked.sha256 = newest.check_run;

CREATE VIEW bar_state AS
WITH RECURSIVE known (bar) AS (
    SELECT min(bar) FROM run WHERE bar > ''
    UNION ALL
    SELECT (SELECT min(next.bar) FROM run AS next WHERE next.bar > known.bar) FROM known WHERE known.bar IS NOT NULL
), newest AS (
    SELECT known.bar,
           (SELECT one.sha256 FROM run AS one WHERE one.bar = known.bar ORDER BY one.measured DESC LIMIT 1) AS last_run
    FROM known WHERE known.bar IS NOT NULL
)
SELECT newest.bar, last.certificate, last.certified_on, last.sha256 AS last_run, last.measured AS last, last.robot
FROM newest JOIN run AS last ON last.sha256 = newest.last_run;

//! The plan's dwells as the alignment sees them.

use super::interval::Commanded;
use crate::plan::{Kind, MODULE_DWELLS, Plan, PlanRow};

/// The dwell rows of a plan and their timing, in order.
pub(super) struct Poses<'a> {
    pub(super) rows: Vec<&'a PlanRow>,
    pub(super) commanded: Vec<Commanded>,
}

/// The program waits that long after a dwell, s.
pub(super) const AFTER_S: f64 = 0.1;

/// Whether the robot stands at a row to be measured.
pub(super) fn stops(row: &PlanRow) -> bool {
    row.kind != Kind::Transit && !row.is_passed()
}

impl<'a> Poses<'a> {
    pub(super) fn of(plan: &'a Plan) -> Self {
        let settle_s = plan.header.job.motion.settle_s;
        let mut poses = Self { rows: Vec::new(), commanded: Vec::new() };
        let (mut move_s, mut module, mut dwells, mut circle) = (0.0, 0, 0, 0);
        for (at, row) in plan.rows.iter().enumerate() {
            move_s += plan.header.moves.get(at).map_or(0.0, |time| time.duration_s);
            // Rows of no circle (the start, the way over) belong to the module that runs.
            let next_circle = row.circle != 0 && circle != 0 && row.circle != circle;
            if row.circle != 0 {
                circle = row.circle;
            }
            if dwells > 0 && (next_circle || dwells == MODULE_DWELLS) {
                module += 1;
                dwells = 0;
            }
            if !stops(row) {
                continue;
            }
            dwells += 1;
            poses.rows.push(row);
            poses.commanded.push(Commanded { move_s, wait_s: settle_s + row.dwell_s + AFTER_S, module });
            move_s = 0.0;
        }
        poses
    }
}

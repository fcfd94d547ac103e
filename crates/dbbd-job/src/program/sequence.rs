//! The sequence of a plan's program, independent of the language: a module for each circle with its motions in order.

use crate::plan::{MotionKind, MoveTime, Plan, PlanRow, PlannedPass, PoseKind};
use crate::program::ProgramFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// A row at which the robot stops, with its time.
#[derive(Clone, Copy, Debug)]
pub struct Timed<'a> {
    pub row: &'a PlanRow,
    pub time: &'a MoveTime,
    /// The pass (a continuous circle) that ends here.
    pub pass: Option<&'a PlannedPass>,
}

impl Timed<'_> {
    /// Whether the row is a counted stop: a dwell, or the end of a pass.
    fn is_counted(&self) -> bool {
        self.row.kind != PoseKind::Transit || self.pass.is_some()
    }

    /// Whether the row is an auxiliary point of an arc or a pass.
    pub fn is_auxiliary(&self) -> bool {
        self.row.is_auxiliary() && self.pass.is_none()
    }
}

impl Plan {
    /// The rows at which the robot stops, in order. It does not stop at the points of a pass.
    fn stops(&self) -> impl Iterator<Item = Timed<'_>> {
        let rows = self.rows.iter().zip(&self.header.moves).filter(|(row, _)| !row.is_passed());
        rows.map(|(row, time)| {
            let pass = self.header.passes.iter().find(|pass| pass.end == row.index);
            Timed { row, time, pass }
        })
    }

    /// The stops that the program counts, in order: the dwells and the ends of the passes. For each the program raises the
    /// strobe once, sets the next index, and reports the row of the stop.
    pub fn counted_stops(&self) -> impl Iterator<Item = Timed<'_>> {
        self.stops().filter(|stop| stop.is_counted())
    }

    /// How many counted stops are complete each time the bar is taken off: before a module for which it is mounted again, and
    /// at the end.
    ///
    /// # Errors
    /// The plan has no program.
    pub fn removals(&self) -> Result<Vec<u32>, Diagnostic> {
        let mut counted = 0;
        let mut removals = Vec::new();
        for module in modules(self)? {
            if module.bar == Bar::ToBeMounted {
                removals.push(counted);
            }
            counted += module.counted().count() as u32;
        }
        removals.push(counted);
        removals.retain(|counted| *counted > 0);
        removals.dedup();
        Ok(removals)
    }
}

/// Whether the bar is mounted at the start of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bar {
    ToBeMounted,
    /// The bar stays on its ball: the robot is already at the start.
    Stays,
}

#[derive(Clone, Debug)]
pub struct Module<'a> {
    pub circle: u32,
    /// Number of the base ball.
    pub ball: u32,
    /// The row at which the bar is mounted.
    pub start: Timed<'a>,
    pub bar: Bar,
    pub rows: Vec<Timed<'a>>,
}

/// A step of a module; rows are numbered from 1.
#[derive(Clone, Copy, Debug)]
pub enum Step<'a> {
    Move {
        row: usize,
        timed: Timed<'a>,
        /// The row of the auxiliary point of an arc.
        through: Option<usize>,
        /// The number of the dwell that follows.
        dwell: Option<usize>,
    },
    /// A continuous circle through the two rows before `row`; numbered with the dwells.
    Pass { row: usize, pass: &'a PlannedPass, number: usize },
}

impl Step<'_> {
    /// The row at which the step ends.
    pub fn row(&self) -> usize {
        match *self {
            Self::Move { row, .. } | Self::Pass { row, .. } => row,
        }
    }
}

/// The modules of a plan. Rows without a circle belong to the circle after them; at the end of the plan, to the last one.
pub fn modules(plan: &Plan) -> Result<Vec<Module<'_>>, Diagnostic> {
    let (rows, moves) = (plan.rows.len(), plan.header.moves.len());
    if rows != moves {
        return Err(ProgramFinding::OtherMoves { rows, moves }.into());
    }
    let mut modules: Vec<Module<'_>> = Vec::new();
    for (circle, rows) in groups(plan)? {
        let module = Module::new(circle, rows, modules.last())?;
        modules.push(module);
    }
    Ok(modules)
}

/// The rows at which the robot stops, by circle.
fn groups(plan: &Plan) -> Result<Vec<(u32, Vec<Timed<'_>>)>, Diagnostic> {
    let mut groups: Vec<(u32, Vec<Timed<'_>>)> = Vec::new();
    let mut leading: Vec<Timed<'_>> = Vec::new();
    for timed in plan.stops() {
        let circle = timed.row.circle;
        match groups.last_mut() {
            _ if circle == 0 => leading.push(timed),
            Some((last, rows)) if *last == circle => {
                rows.append(&mut leading);
                rows.push(timed);
            }
            _ => {
                let mut rows = std::mem::take(&mut leading);
                rows.push(timed);
                groups.push((circle, rows));
            }
        }
    }
    match groups.last_mut() {
        Some((_, rows)) => rows.append(&mut leading),
        None => return Err(ProgramFinding::NoRows.into()),
    }
    Ok(groups)
}

impl<'a> Module<'a> {
    fn new(circle: u32, mut rows: Vec<Timed<'a>>, before: Option<&Module<'a>>) -> Result<Self, Diagnostic> {
        let before = before.and_then(|module| module.rows.last().copied());
        let is_approach =
            |timed: &&Timed<'a>| timed.row.motion == MotionKind::Ptp && timed.row.kind == PoseKind::Transit;
        let leading = rows.iter().take_while(is_approach).count();
        let Some(first) = rows.first().copied() else { return Err(ProgramFinding::NoRows.into()) };
        let mut bar = Bar::ToBeMounted;
        let start = match (leading.checked_sub(1).and_then(|at| rows.get(at)), before) {
            (Some(start), _) => *start,
            (None, _) if first.row.motion == MotionKind::Ptp => first,
            (None, Some(before)) if before.row.centre == first.row.centre => {
                bar = Bar::Stays;
                before
            }
            (None, _) => return Err(ProgramFinding::RowStart { row: first.row.index }.into()),
        };
        if before.is_some_and(|before| before.row.centre == first.row.centre && same_place(before, start)) {
            bar = Bar::Stays;
        }
        // The last of the leading transits is the start; earlier ones remain as via points.
        if leading > 0 {
            rows.remove(leading - 1);
        }
        let ball = rows.first().map_or(0, |timed| timed.row.centre.number());
        if let Some(Timed { row, .. }) = rows.iter().find(|timed| timed.row.centre.number() != ball) {
            let other =
                ProgramFinding::RowOtherBall { row: row.index, ball: row.centre.number(), circle_ball: ball };
            return Err(other.into());
        }
        Ok(Self { circle, ball, start, bar, rows })
    }

    pub fn steps(&self) -> Result<Vec<Step<'a>>, Diagnostic> {
        let mut steps = Vec::new();
        let mut counted = 0;
        for (at, timed) in self.rows.iter().enumerate() {
            let next_is_arc = self.rows.get(at + 1).is_some_and(|next| next.row.motion == MotionKind::Circ);
            if timed.is_auxiliary() && next_is_arc {
                continue; // the auxiliary point of the next row
            }
            counted += usize::from(timed.is_counted());
            let row = at + 1;
            if let Some(pass) = timed.pass {
                steps.push(Step::Pass { row, pass, number: counted });
                continue;
            }
            let through = match timed.row.motion {
                MotionKind::Circ => Some(self.auxiliary(at)?),
                MotionKind::Ptp | MotionKind::Lin => None,
            };
            let dwell = (timed.row.kind != PoseKind::Transit).then_some(counted);
            steps.push(Step::Move { row, timed: *timed, through, dwell });
        }
        Ok(steps)
    }

    /// The row of the auxiliary point (from 1) of the arc at the index `at`.
    fn auxiliary(&self, at: usize) -> Result<usize, Diagnostic> {
        let before = at.checked_sub(1).and_then(|before| self.rows.get(before));
        match (before, self.rows.get(at)) {
            (Some(before), _) if before.row.is_auxiliary() => Ok(at),
            (_, arc) => Err(ProgramFinding::RowArc { row: arc.map_or(0, |arc| arc.row.index) }.into()),
        }
    }

    /// The counted stops of the module.
    pub fn counted(&self) -> impl Iterator<Item = &Timed<'a>> {
        self.rows.iter().filter(|timed| timed.is_counted())
    }

    /// The row (from 1) at which the end marker ends: the last line shorter than a millimetre. Rows after it lead to the next
    /// circle. Without a marker, the last row.
    pub fn end_mark(&self) -> usize {
        let is_mark = |pair: &[Timed<'_>]| match pair {
            [from, to] => {
                let steps = from.row.xyz_mm.iter().zip(&to.row.xyz_mm);
                let square: f64 = steps.map(|(a, b)| (a - b).powi(2)).sum();
                to.row.kind == PoseKind::Transit && to.row.motion == MotionKind::Lin && square < 1.0
            }
            _ => false,
        };
        self.rows.windows(2).rposition(is_mark).map_or(self.rows.len(), |at| at + 2)
    }
}

/// Whether the axis angles of two rows are the same.
fn same_place(a: Timed<'_>, b: Timed<'_>) -> bool {
    (0..AXES).all(|axis| (a.row.axes_deg[axis] - b.row.axes_deg[axis]).abs() < 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::circle_plan;

    /// The stops that all modules count, by their rows.
    fn of_modules(plan: &Plan) -> Vec<u32> {
        let modules = modules(plan).unwrap();
        modules.iter().flat_map(Module::counted).map(|timed| timed.row.index).collect()
    }

    fn of_plan(plan: &Plan) -> Vec<u32> {
        plan.counted_stops().map(|stop| stop.row.index).collect()
    }

    /// Two circles of three dwells and a visit of the reference.
    #[test]
    fn dwells_are_counted() {
        let plan = circle_plan::plan(2, 3);
        let dwells = plan.rows.iter().filter(|row| row.dwell_s > 0.0).map(|row| row.index);
        assert_eq!(of_plan(&plan), dwells.collect::<Vec<u32>>());
        assert_eq!((of_plan(&plan).len(), of_modules(&plan)), (8, of_plan(&plan)));
    }

    /// The rows of the second circle as a pass: its points are not counted, its end is.
    #[test]
    fn a_pass_is_counted_once_at_its_end() {
        let mut plan = circle_plan::plan(2, 3);
        let points = plan.rows.iter_mut().filter(|row| row.circle == 2 && row.kind != PoseKind::Transit);
        let passed: Vec<u32> = points
            .map(|row| {
                row.dwell_s = 0.0;
                row.index
            })
            .collect();
        let (first, last) = (passed[0], passed[passed.len() - 1]);
        plan.header.passes.push(PlannedPass {
            circle: 2,
            clockwise: false,
            through: [first - 2, first - 1],
            points: [first, last],
            end: last + 1,
            sweep_deg: 60.0,
            length_mm: 300.0,
            feed_mm_s: 20.0,
            acceleration_mm_s2: 200.0,
            duration_s: 16.0,
        });
        let counted = of_plan(&plan);
        assert_eq!(
            (counted.len(), counted.last(), of_modules(&plan)),
            (5, Some(&(last + 1)), counted.clone())
        );
        let ends: Vec<bool> = plan.counted_stops().map(|stop| stop.pass.is_some()).collect();
        assert_eq!(ends, [false, false, false, false, true]);
    }

    #[test]
    fn bar_is_taken_off_before_a_module_that_begins_elsewhere() {
        let mut plan = circle_plan::plan(2, 3);
        assert_eq!(plan.removals().unwrap(), [4, 8]);
        let start = plan.rows.iter().position(|row| row.circle == 2).unwrap();
        plan.rows[start].axes_deg = plan.rows[start - 1].axes_deg;
        assert_eq!(plan.removals().unwrap(), [8]);
        // The same place about another ball.
        for row in &mut plan.rows[start..] {
            row.centre = dbbd_model::robot::BallId::at(1);
        }
        assert_eq!(plan.removals().unwrap(), [4, 8]);
    }
}

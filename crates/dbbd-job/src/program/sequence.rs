//! The sequence of a plan's program, independent of the language: a module for each circle with its motions in order.

use crate::plan::{MotionKind, MoveTime, Plan, PlanRow, PlannedPass, PoseKind};
use crate::program::ProgramFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// A row with its time.
#[derive(Clone, Copy, Debug)]
pub struct Timed<'a> {
    pub row: &'a PlanRow,
    pub time: &'a MoveTime,
    /// The pass (a continuous circle) that ends here.
    pub pass: Option<&'a PlannedPass>,
}

impl Timed<'_> {
    /// Whether the row is numbered in its module: a dwell, or the end of a pass.
    fn is_counted(&self) -> bool {
        self.row.kind != PoseKind::Transit || self.pass.is_some()
    }

    /// Whether the row is an auxiliary point of an arc or a pass.
    pub fn is_auxiliary(&self) -> bool {
        self.row.is_auxiliary() && self.pass.is_none()
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
    for (row, time) in plan.rows.iter().zip(&plan.header.moves).filter(|(row, _)| !row.is_passed()) {
        let pass = plan.header.passes.iter().find(|pass| pass.end == row.index);
        let timed = Timed { row, time, pass };
        match groups.last_mut() {
            _ if row.circle == 0 => leading.push(timed),
            Some((last, rows)) if *last == row.circle => {
                rows.append(&mut leading);
                rows.push(timed);
            }
            _ => {
                let mut rows = std::mem::take(&mut leading);
                rows.push(timed);
                groups.push((row.circle, rows));
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

    /// The rows that are numbered.
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

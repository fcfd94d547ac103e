//! The data of a circle's module: set-up, points, speeds.

use super::number::{degrees, metre_per_second, millimetre, seconds};
use super::{Controller, HEAD, Lines, Sync, Writer};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::job::Outputs;
use crate::plan::{Frames, Motion, PlanRow};
use crate::program::sequence::{Module, Timed};
use crate::robot::{AXES, Joint, Mass};

impl Writer<'_> {
    /// The one mass on the flange, where the robot file has it.
    pub(super) fn payload(&self) -> Option<&Mass> {
        let mut carried = self.robot.geometry.masses.iter().filter(|mass| mass.joint == Joint::J6);
        carried.next().filter(|_| carried.next().is_none())
    }

    pub(super) fn data(&self, name: &str, module: &Module<'_>) -> Result<Lines, Diagnostic> {
        let mut data = Lines::default();
        data.all(HEAD);
        data.add(format!("DEFDAT {name}"));
        data.all(&self.made);
        data.all(self.external());
        self.identity(&mut data);
        self.cell(&mut data, module)?;
        match self.options.sync {
            Sync::Marker => {}
            Sync::Output => signals(&mut data, &self.plan.header.job.motion.outputs)?,
            Sync::Ekrl { .. } => self.ekrl_data(&mut data),
        }
        if self.options.controller != Controller::Krc2 {
            data.add("; whether the controller corrected by an accuracy model of its own, filled in by the program");
            data.add("DECL BOOL DBBABS=FALSE");
        }
        data.add(format!("DECL E6AXIS XSTART={}", axis_text(&module.start.row.axes_deg)));
        self.points(&mut data, module)?;
        data.add("; rows of the plan by dwell, and the measured axes, filled in by the program");
        let dwells = module.counted().count().max(1);
        data.add(format!("DECL INT DBBROW[{dwells}]"));
        for (at, timed) in module.counted().enumerate() {
            data.add(format!("DBBROW[{}]={}", at + 1, timed.row.index));
        }
        data.add(format!("DECL E6AXIS XQ[{dwells}]"));
        data.add("ENDDAT");
        Ok(data)
    }

    /// Ball, bar, tool and base.
    fn cell(&self, data: &mut Lines, module: &Module<'_>) -> Result<(), Diagnostic> {
        let job = &self.plan.header.job;
        let frame = |xyz: [f64; 3]| frame_text(&xyz, &[0.0; 3]);
        let ball = module.ball;
        let Some(table) = job.centres.iter().find(|table| table.id == ball) else {
            return Err(ProgramFinding::NoBall { ball }.into());
        };
        data.add("; number and centre of the base ball, bar length, stroke, mm");
        data.add(format!("DECL INT DBBBALL={ball}"));
        data.add(format!("DECL FRAME DBBCEN={}", frame(table.xyz_mm)));
        data.add(format!("DECL REAL DBBLEN={}", millimetre(job.bar.length_mm)));
        data.add(format!("DECL REAL DBBLOW={}", millimetre(job.bar.stroke_mm[0])));
        data.add(format!("DECL REAL DBBHIGH={}", millimetre(job.bar.stroke_mm[1])));
        data.add(format!("DECL REAL TSET={}", seconds(job.motion.settle_s)));
        let [.., a, b, c] = job.motion.tool.unwrap_or_default();
        data.add(format!("DECL FRAME FTOOL={}", frame_text(&self.robot.geometry.tool.into(), &[a, b, c])));
        let [x, y, z, a, b, c] = job.motion.base.unwrap_or_default();
        data.add(format!("DECL FRAME FBASE={}", frame_text(&[x, y, z], &[a, b, c])));
        if let Some(mass) = self.payload() {
            let (kg, centre) = (millimetre(mass.kg), frame(mass.centre.into()));
            data.add(format!("DECL LOAD LTOOL={{M {kg},CM {centre},J {{X 0.000,Y 0.000,Z 0.000}}}}"));
        }
        Ok(())
    }

    fn points(&self, data: &mut Lines, module: &Module<'_>) -> Result<(), Diagnostic> {
        let frames = self.plan.header.job.motion.frames();
        data.add("; points, speeds along the path (m/s) and of the orientation (deg/s)");
        let count = module.rows.len().max(1);
        for declaration in ["E6POS XP", "REAL VP", "REAL VO"] {
            data.add(format!("DECL {declaration}[{count}]"));
        }
        for (at, timed) in module.rows.iter().enumerate() {
            check(timed)?;
            let (at, Timed { row, time, .. }) = (at + 1, timed);
            data.add(format!("XP[{at}]={}", position_text(row, &frames)));
            if row.motion != Motion::Ptp && !timed.is_auxiliary() {
                data.add(format!("VP[{at}]={}", metre_per_second(time.feed_mm_s * 1e-3)));
                data.add(format!("VO[{at}]={}", degrees(time.turn_deg_s)));
            }
        }
        Ok(())
    }
}

/// Strobe and index on the outputs of the job.
fn signals(data: &mut Lines, outputs: &Outputs) -> Result<(), Diagnostic> {
    let [first, last] = outputs.index;
    let within = [outputs.strobe, first, last].into_iter().all(|output| (1..=4096).contains(&output));
    let eight = last.checked_sub(first) == Some(7);
    if !(within && eight) || (first..=last).contains(&outputs.strobe) {
        return Err(ProgramFinding::OutputsOverlap.into());
    }
    data.add(format!("SIGNAL DBBSTB $OUT[{}]", outputs.strobe));
    data.add(format!("SIGNAL DBBIDX $OUT[{first}] TO $OUT[{last}]"));
    Ok(())
}

/// What KRL can hold: finite numbers, status and turn bits, speeds above zero.
fn check(timed: &Timed<'_>) -> Result<(), ProgramFinding> {
    let Timed { row: PlanRow { index: row, status, turn, dwell_s, motion, .. }, time, .. } = *timed;
    let (&row, &status, &turn, &dwell_s) = (row, status, turn, dwell_s);
    if time.index != row {
        return Err(ProgramFinding::OtherMove { row, index: time.index });
    }
    let numbers = timed.row.xyz_mm.iter().chain(&timed.row.abc_deg).chain(&timed.row.axes_deg);
    if let Some(&value) = numbers.into_iter().find(|value| !value.is_finite() || value.abs() >= 1e6) {
        return Err(ProgramFinding::RowNumber { row, value });
    }
    if status > 31 || turn > 63 {
        return Err(ProgramFinding::RowConfiguration { row, status, turn });
    }
    if !(0.0..=600.0).contains(&dwell_s) {
        return Err(ProgramFinding::RowDwell { row, dwell_s });
    }
    let (percent, feed_mm_s, turn_deg_s) = (time.axis_percent, time.feed_mm_s, time.turn_deg_s);
    match motion {
        Motion::Ptp if !(1.0..=100.0).contains(&percent) => {
            Err(ProgramFinding::RowAxisSpeed { row, percent })
        }
        Motion::Ptp => Ok(()),
        _ if timed.is_auxiliary() => Ok(()),
        _ if !(0.01..=2000.0).contains(&feed_mm_s) => Err(ProgramFinding::RowFeed { row, feed_mm_s }),
        _ if !(0.01..=1000.0).contains(&turn_deg_s) => Err(ProgramFinding::RowTurn { row, turn_deg_s }),
        _ => Ok(()),
    }
}

/// External axes, which this robot does not have; all components are always given, since missing
/// ones are taken from the point before.
const EXTERNAL: &str = "E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0";

fn frame_text(xyz_mm: &[f64; 3], abc_deg: &[f64; 3]) -> String {
    let [x, y, z] = xyz_mm.map(millimetre);
    let [a, b, c] = abc_deg.map(degrees);
    format!("{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}")
}

fn position_text(row: &PlanRow, frames: &Frames) -> String {
    let (xyz_mm, abc_deg) = frames.printed(row);
    let frame = frame_text(&xyz_mm, &abc_deg);
    let frame = frame.trim_end_matches('}');
    format!("{frame},S {},T {},{EXTERNAL}}}", row.status, row.turn)
}

fn axis_text(axes_deg: &[f64; AXES]) -> String {
    let [a1, a2, a3, a4, a5, a6] = axes_deg.map(degrees);
    format!("{{A1 {a1},A2 {a2},A3 {a3},A4 {a4},A5 {a5},A6 {a6},{EXTERNAL}}}")
}

//! The data of a circle's module: set-up, points, speeds.

use super::super::number::{degrees, metre_per_second, millimetre, seconds};
use super::{Circle, Controller, EmitError, HEAD, Lines, Sync, Writer};
use crate::model::AXES;
use crate::plan::{Frames, Motion, MoveTime, PlanRow};

impl Writer<'_> {
    /// Mass (kg) and centre (mm) of what the flange carries, where the robot file tells.
    pub(super) fn payload(&self) -> Option<(f64, [f64; 3])> {
        let mut carried = self.robot.geometry.masses.iter().filter(|mass| mass.joint == AXES);
        match (carried.next(), carried.next()) {
            (Some(mass), None) => Some((mass.kg, mass.centre.into())),
            _ => None,
        }
    }

    pub(super) fn data(
        &self,
        data: &mut Lines,
        name: &str,
        circle: &Circle<'_>,
        centre: u32,
        dwells: usize,
    ) -> Result<(), EmitError> {
        let job = &self.plan.header.job;
        let frame = |xyz: [f64; 3]| frame_text(&xyz, &[0.0; 3]);
        data.all(HEAD);
        data.add(format!("DEFDAT {name}"));
        data.all(self.external());
        self.identity(data);
        let Some(ball) = job.centres.iter().find(|ball| ball.id == centre).map(|ball| ball.xyz_mm) else {
            return Err(EmitError::Setup(format!("the job has no ball {centre}")));
        };
        data.add("; number and centre of the base ball, bar length, stroke, mm");
        data.add(format!("DECL INT DBBBALL={centre}"));
        data.add(format!("DECL FRAME DBBCEN={}", frame(ball)));
        data.add(format!("DECL REAL DBBLEN={}", millimetre(job.bar.length_mm)));
        data.add(format!("DECL REAL DBBLOW={}", millimetre(job.bar.stroke_mm[0])));
        data.add(format!("DECL REAL DBBHIGH={}", millimetre(job.bar.stroke_mm[1])));
        data.add(format!("DECL REAL TSET={}", seconds(job.motion.settle_s)));
        let [.., a, b, c] = job.motion.tool.unwrap_or_default();
        data.add(format!("DECL FRAME FTOOL={}", frame_text(&self.robot.geometry.tool.into(), &[a, b, c])));
        let [x, y, z, a, b, c] = job.motion.base.unwrap_or_default();
        data.add(format!("DECL FRAME FBASE={}", frame_text(&[x, y, z], &[a, b, c])));
        if let Some((kg, xyz)) = self.payload() {
            let inertia = "{X 0.000,Y 0.000,Z 0.000}";
            data.add(format!("DECL LOAD LTOOL={{M {},CM {},J {inertia}}}", millimetre(kg), frame(xyz)));
        }
        if self.options.sync == Sync::Output {
            let outputs = job.motion.outputs;
            let [first, last] = outputs.index;
            let within = |output: u32| (1..=4096).contains(&output);
            if !(within(outputs.strobe)
                && within(first)
                && within(last)
                && last.checked_sub(first) == Some(7))
                || (first..=last).contains(&outputs.strobe)
            {
                let message = "outputs: the index needs eight outputs in a row, and the strobe another";
                return Err(EmitError::Setup(message.into()));
            }
            data.add(format!("SIGNAL DBBSTB $OUT[{}]", outputs.strobe));
            data.add(format!("SIGNAL DBBIDX $OUT[{first}] TO $OUT[{last}]"));
        }
        if matches!(self.options.sync, Sync::Ekrl { .. }) {
            self.ekrl_data(data);
        }
        if self.options.controller != Controller::Krc2 {
            data.add("; whether the controller corrected by an accuracy model of its own, filled in by the program");
            data.add("DECL BOOL DBBABS=FALSE");
        }
        data.add(format!("DECL E6AXIS XSTART={}", axis_text(&circle.start_deg)));
        data.add("; points, speeds along the path (m/s) and of the orientation (deg/s)");
        let count = circle.rows.len().max(1);
        for declaration in ["E6POS XP", "REAL VP", "REAL VO"] {
            data.add(format!("DECL {declaration}[{count}]"));
        }
        for (at, (row, time)) in circle.rows.iter().enumerate() {
            let auxiliary = row.is_auxiliary() && self.pass(row).is_none();
            check(row, time, auxiliary)?;
            let at = at + 1;
            data.add(format!("XP[{at}]={}", position_text(row, &job.motion.frames())));
            if row.motion != Motion::Ptp && !auxiliary {
                data.add(format!("VP[{at}]={}", metre_per_second(time.feed_mm_s * 1e-3)));
                data.add(format!("VO[{at}]={}", degrees(time.turn_deg_s)));
            }
        }
        data.add("; rows of the plan by dwell, and the measured axes, filled in by the program");
        data.add(format!("DECL INT DBBROW[{}]", dwells.max(1)));
        let measured = circle.rows.iter().filter(|(row, _)| self.is_told(row));
        for (at, (row, _)) in measured.enumerate() {
            data.add(format!("DBBROW[{}]={}", at + 1, row.index));
        }
        data.add(format!("DECL E6AXIS XQ[{}]", dwells.max(1)));
        data.add("ENDDAT");
        Ok(())
    }
}

/// What KRL can hold: finite numbers, status and turn bits, speeds above zero.
fn check(row: &PlanRow, time: &MoveTime, auxiliary: bool) -> Result<(), EmitError> {
    let wrong = |message: String| Err(EmitError::Row { index: row.index, message });
    if time.index != row.index {
        return wrong(format!("its move time has index {}", time.index));
    }
    let numbers = row.xyz_mm.iter().chain(&row.abc_deg).chain(&row.axes_deg);
    if let Some(value) = numbers.copied().find(|value| !value.is_finite() || value.abs() >= 1e6) {
        return wrong(format!("{value} is no length or angle that a controller accepts"));
    }
    if row.status > 31 || row.turn > 63 {
        return wrong(format!("status {} and turn {} are out of range", row.status, row.turn));
    }
    if !(0.0..=600.0).contains(&row.dwell_s) {
        return wrong(format!("a dwell of {} s", row.dwell_s));
    }
    match row.motion {
        Motion::Ptp if !(1.0..=100.0).contains(&time.axis_percent) => {
            wrong(format!("an axis speed of {} percent", time.axis_percent))
        }
        Motion::Lin | Motion::Circ if !auxiliary && !(0.01..=2000.0).contains(&time.feed_mm_s) => {
            wrong(format!("a feed of {} mm/s", time.feed_mm_s))
        }
        Motion::Lin | Motion::Circ if !auxiliary && !(0.01..=1000.0).contains(&time.turn_deg_s) => {
            wrong(format!("an orientation speed of {} deg/s", time.turn_deg_s))
        }
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

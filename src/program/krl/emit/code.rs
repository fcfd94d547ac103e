//! The code of a circle's module.

use super::number::{degrees, metre_per_second, percent, seconds};
use super::{Controller, HEAD, INI, Lines, Sync, Writer};
use crate::diagnostic::Diagnostic;
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Kind, Motion, Pass};
use crate::program::sequence::{Bar, Module, Step, Timed};

impl Writer<'_> {
    pub(super) fn code(&self, name: &str, module: &Module<'_>) -> Result<Lines, Diagnostic> {
        let mut source = Lines::default();
        let output = self.options.sync == Sync::Output;
        let ekrl = matches!(self.options.sync, Sync::Ekrl { .. });
        source.all(HEAD);
        source.add(format!("DEF {name} ( )"));
        source.all(&self.made);
        source.all(INI);
        self.set_up(&mut source, module);
        if output {
            source.add("DBB_SYNC (3)");
        }
        if ekrl {
            Self::ekrl_open(&mut source);
        }
        let end_mark = module.end_mark();
        for step in module.steps()? {
            self.step(&mut source, &step);
            if output && step.row() == end_mark {
                source.add("DBB_SYNC (2)");
            }
        }
        if ekrl {
            Self::ekrl_close(&mut source);
        }
        source.add("END");
        self.subroutines(&mut source, module);
        Ok(source)
    }

    fn set_up(&self, source: &mut Lines, module: &Module<'_>) {
        source.add(format!("; circle {}, plan {}", module.circle, self.hash()));
        source.add(";FOLD DBB SETUP");
        if self.options.sync == Sync::Output {
            source.all(&["DBBSTB=FALSE", "DBBIDX=0"]);
        }
        if self.options.controller != Controller::Krc2 {
            source.add("DBBABS=$ABS_ACCUR");
        }
        source.add(format!("BAS (#VEL_PTP,{} )", percent(module.start.time.axis_percent)));
        source.add(format!("BAS (#ACC_PTP,{} )", percent(PTP_ACCELERATION_PERCENT)));
        source.all(&["$TOOL=FTOOL", "$BASE=FBASE"]);
        if self.payload().is_some() {
            source.add("$LOAD=LTOOL");
        }
        source.all(&["$IPO_MODE=#BASE", "$ORI_TYPE=#VAR", "$CIRC_TYPE=#BASE"]);
        source.add(format!("$ACC.CP={}", metre_per_second(1e-3 * ACCELERATION_MM_S2)));
        source.add(format!("$ACC.ORI1={}", degrees(ACCELERATION_DEG_S2)));
        source.add(format!("$ACC.ORI2={}", degrees(ACCELERATION_DEG_S2)));
        source.all(&["$ADVANCE=1", ";ENDFOLD (DBB SETUP)", "PTP XSTART"]);
        let ball = module.ball;
        match module.bar {
            Bar::Stays => source.add(format!("; the ball bar stays on ball {ball}")),
            Bar::ToBeMounted => {
                source.add(format!("; mount the ball bar on ball {ball} now, then press START"));
                source.add("HALT");
            }
        }
    }

    fn step(&self, source: &mut Lines, step: &Step<'_>) {
        match *step {
            Step::Pass { row, pass, number } => self.pass_code(source, pass, number, row),
            Step::Move { row: at, timed: Timed { row, time, .. }, through, dwell } => {
                source.add(format!("; row {}, {}", row.index, kind_word(row.kind)));
                match (row.motion, through) {
                    (Motion::Ptp, _) => {
                        source.add(format!("BAS (#VEL_PTP,{} )", percent(time.axis_percent)));
                        source.add(format!("PTP XP[{at}]"));
                    }
                    (_, Some(through)) => {
                        source.add(format!("DBB_FEED ({at})"));
                        source.add(format!("CIRC XP[{through}],XP[{at}]"));
                    }
                    (_, None) => {
                        source.add(format!("DBB_FEED ({at})"));
                        source.add(format!("LIN XP[{at}]"));
                    }
                }
                if let Some(dwell) = dwell {
                    source.add(format!("DBB_MARK ({dwell},{})", seconds(row.dwell_s)));
                }
            }
        }
    }

    /// One motion round a circle without stops: through two points, and on by its whole angle.
    fn pass_code(&self, source: &mut Lines, pass: &Pass, number: usize, at: usize) {
        let [first, last] = pass.points;
        let sense = if pass.clockwise { "clockwise" } else { "counter-clockwise" };
        source.add(format!("; rows {first} to {last}, one pass {sense}"));
        source.add(format!("DBB_FEED ({at})"));
        source.add(format!("DBB_GO ({number})"));
        // On a KR C2 there is no SCIRC; its CIRC is a circle only while it is slow.
        let word = if self.options.controller == Controller::Krc2 { "CIRC" } else { "SCIRC" };
        let (via, to) = (at.saturating_sub(2), at.saturating_sub(1));
        source.add(format!("{word} XP[{via}],XP[{to}],CA {}", degrees(pass.sweep_deg)));
        source.add(format!("DBB_STOP ({number})"));
    }

    fn subroutines(&self, source: &mut Lines, module: &Module<'_>) {
        source.all(&[
            "",
            "DEF DBB_FEED (K :IN )",
            "INT K",
            "; speeds of the motion to point K",
            "$VEL.CP=VP[K]",
            "$VEL.ORI1=VO[K]",
            "$VEL.ORI2=VO[K]",
            "END",
        ]);
        if module.rows.iter().any(|timed| timed.row.kind != Kind::Transit) {
            self.mark_subroutine(source);
        }
        if module.rows.iter().any(|timed| timed.pass.is_some()) {
            self.pass_subroutines(source);
        }
        match self.options.sync {
            Sync::Marker => {}
            Sync::Ekrl { .. } => Self::ekrl_subroutine(source),
            Sync::Output => self.sync_subroutine(source),
        }
    }

    fn pass_subroutines(&self, source: &mut Lines) {
        let (begin, end): (&[&str], &[&str]) = match self.options.sync {
            Sync::Marker => (&[], &[]),
            Sync::Output => (&["DBBIDX=N", "DBBSTB=TRUE"], &["DBBSTB=FALSE"]),
            Sync::Ekrl { .. } => (&["DBB_ESEND (DBBROW[N],1)"], &["DBB_ESEND (DBBROW[N],2)"]),
        };
        source.all(&["", "DEF DBB_GO (N :IN )", "INT N", "; stand still before pass N", "WAIT SEC 0"]);
        source.add("WAIT SEC TSET");
        source.all(begin);
        source.all(&["END", "", "DEF DBB_STOP (N :IN )", "INT N", "; pass N has ended: log the axes"]);
        source.add("WAIT SEC 0");
        source.all(end);
        source.all(&["XQ[N]=$AXIS_ACT_MEAS", "WAIT SEC 0.1", "END"]);
    }

    fn mark_subroutine(&self, source: &mut Lines) {
        source.all(&[
            "",
            "DEF DBB_MARK (N :IN,TDW :IN )",
            "INT N",
            "REAL TDW",
            "; stand still: settle, log the axes, dwell",
            "WAIT SEC 0",
            "WAIT SEC TSET",
        ]);
        source.all(match self.options.sync {
            Sync::Marker => &["XQ[N]=$AXIS_ACT_MEAS", "WAIT SEC TDW"],
            Sync::Output => {
                &["DBBIDX=N", "XQ[N]=$AXIS_ACT_MEAS", "DBBSTB=TRUE", "WAIT SEC TDW", "DBBSTB=FALSE"]
            }
            Sync::Ekrl { .. } => &[
                "XQ[N]=$AXIS_ACT_MEAS",
                "DBB_ESEND (DBBROW[N],1)",
                "WAIT SEC TDW",
                "DBB_ESEND (DBBROW[N],2)",
            ],
        });
        source.all(&["WAIT SEC 0.1", "END"]);
    }

    fn sync_subroutine(&self, source: &mut Lines) {
        source.all(&[
            "",
            "DEF DBB_SYNC (N :IN )",
            "INT N",
            "INT K",
            "; N short pulses of the strobe: 3 at the start, 2 at the end",
            "WAIT SEC 0",
            "FOR K=1 TO N STEP 1",
        ]);
        source.add(format!("   PULSE ($OUT[{}],TRUE,0.2)", self.plan.header.job.motion.outputs.strobe));
        source.all(&["   WAIT SEC 0.6", "ENDFOR", "END"]);
    }
}

fn kind_word(kind: Kind) -> &'static str {
    match kind {
        Kind::Measure => "measure",
        Kind::Reference => "reference",
        Kind::Transit => "transit",
    }
}

//! The code of a circle's module.

use super::super::number::{degrees, metre_per_second, percent, seconds};
use super::{Circle, Controller, EmitError, HEAD, INI, Lines, Sync, Timed, Writer};
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Kind, Motion, Pass};

impl Writer<'_> {
    pub(super) fn code(
        &self,
        source: &mut Lines,
        name: &str,
        circle: &Circle<'_>,
        centre: u32,
    ) -> Result<(), EmitError> {
        let output = self.options.sync == Sync::Output;
        source.all(HEAD);
        source.add(format!("DEF {name} ( )"));
        source.all(INI);
        source.add(format!("; circle {}, plan {}", circle.number, self.hash()));
        source.add(";FOLD DBB SETUP");
        if output {
            source.all(&["DBBSTB=FALSE", "DBBIDX=0"]);
        }
        if self.options.controller != Controller::Krc2 {
            source.add("DBBABS=$ABS_ACCUR");
        }
        source.add(format!("BAS (#VEL_PTP,{} )", percent(circle.start_percent)));
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
        if circle.mounted {
            source.add(format!("; the ball bar stays on ball {centre}"));
        } else {
            source.add(format!("; mount the ball bar on ball {centre} now, then press START"));
            source.add("HALT");
        }
        if output {
            source.add("DBB_SYNC (3)");
        }
        let ekrl = matches!(self.options.sync, Sync::Ekrl { .. });
        if ekrl {
            Self::ekrl_open(source);
        }
        let end_mark = last_knock(circle);
        let mut dwell = 0;
        let mut rows = circle.rows.iter().enumerate().peekable();
        while let Some((at, (row, time))) = rows.next() {
            let at = at + 1;
            if let Some(pass) = self.pass(row) {
                dwell += 1;
                self.pass_code(source, pass, dwell, at);
                if output && end_mark == at {
                    source.add("DBB_SYNC (2)");
                }
                continue;
            }
            let next = rows.peek().map(|(_, (next, _))| *next);
            if row.kind == Kind::Transit
                && row.motion == Motion::Circ
                && next.is_some_and(|next| next.motion == Motion::Circ)
            {
                continue; // the auxiliary point of the next row
            }
            source.add(format!("; row {}, {}", row.index, kind_word(row.kind)));
            match row.motion {
                Motion::Ptp => {
                    source.add(format!("BAS (#VEL_PTP,{} )", percent(time.axis_percent)));
                    source.add(format!("PTP XP[{at}]"));
                }
                Motion::Lin => {
                    source.add(format!("DBB_FEED ({at})"));
                    source.add(format!("LIN XP[{at}]"));
                }
                Motion::Circ => {
                    let through = at.checked_sub(2).and_then(|at| circle.rows.get(at)).map(|(row, _)| row);
                    if !through.is_some_and(|row| row.kind == Kind::Transit && row.motion == Motion::Circ) {
                        let message = "an arc needs its auxiliary point in the transit row before".into();
                        return Err(EmitError::Row { index: row.index, message });
                    }
                    source.add(format!("DBB_FEED ({at})"));
                    source.add(format!("CIRC XP[{}],XP[{at}]", at - 1));
                }
            }
            if row.kind != Kind::Transit {
                dwell += 1;
                source.add(format!("DBB_MARK ({dwell},{})", seconds(row.dwell_s)));
            }
            if output && end_mark == at {
                source.add("DBB_SYNC (2)");
            }
        }
        if ekrl {
            Self::ekrl_close(source);
        }
        source.add("END");
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
        let dwells = circle.rows.iter().any(|(row, _)| row.kind != Kind::Transit);
        let passes = circle.rows.iter().any(|(row, _)| self.pass(row).is_some());
        if dwells {
            self.mark_subroutine(source);
        }
        if passes {
            self.pass_subroutines(source);
        }
        match self.options.sync {
            Sync::Marker => {}
            Sync::Ekrl { .. } => Self::ekrl_subroutine(source),
            Sync::Output => self.sync_subroutine(source),
        }
        Ok(())
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
        source.add(format!("{word} XP[{}],XP[{}],CA {}", at - 2, at - 1, degrees(pass.sweep_deg)));
        source.add(format!("DBB_STOP ({number})"));
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

/// The row (from 1) that ends the end mark, a knock being a line of less than a millimetre; what may
/// follow it is the way to the next circle. Without knocks the last row.
fn last_knock(circle: &Circle<'_>) -> usize {
    let is_knock = |pair: &[Timed<'_>]| match pair {
        [(from, _), (to, _)] => {
            let square: f64 = from.xyz_mm.iter().zip(&to.xyz_mm).map(|(a, b)| (a - b).powi(2)).sum();
            to.kind == Kind::Transit && to.motion == Motion::Lin && square < 1.0
        }
        _ => false,
    };
    circle.rows.windows(2).rposition(is_knock).map_or(circle.rows.len(), |at| at + 2)
}

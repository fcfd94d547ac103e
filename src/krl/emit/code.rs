//! The code of a circle's module.

use super::super::number::{degrees, metre_per_second, percent, seconds};
use super::{Circle, Controller, EmitError, HEAD, INI, Lines, Sync, Timed, Writer};
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Kind, Motion};

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
        self.subroutines(source);
        Ok(())
    }

    fn subroutines(&self, source: &mut Lines) {
        source.all(&[
            "",
            "DEF DBB_FEED (K :IN )",
            "; speeds of the motion to point K",
            "INT K",
            "$VEL.CP=VP[K]",
            "$VEL.ORI1=VO[K]",
            "$VEL.ORI2=VO[K]",
            "END",
            "",
            "DEF DBB_MARK (N :IN,TDW :IN )",
            "; stand still: settle, log the axes, dwell",
            "INT N",
            "REAL TDW",
            "WAIT SEC 0",
            "WAIT SEC TSET",
        ]);
        match self.options.sync {
            Sync::Marker => {
                source.all(&["XQ[N]=$AXIS_ACT_MEAS", "WAIT SEC TDW", "WAIT SEC 0.1", "END"]);
                return;
            }
            Sync::Ekrl { .. } => return Self::ekrl_subroutines(source),
            Sync::Output => {}
        }
        source.all(&[
            "DBBIDX=N",
            "XQ[N]=$AXIS_ACT_MEAS",
            "DBBSTB=TRUE",
            "WAIT SEC TDW",
            "DBBSTB=FALSE",
            "WAIT SEC 0.1",
            "END",
            "",
            "DEF DBB_SYNC (N :IN )",
            "; N short pulses of the strobe: 3 at the start, 2 at the end",
            "INT N",
            "INT K",
            "WAIT SEC 0",
            "FOR K=1 TO N STEP 1",
        ]);
        source.add(format!("PULSE ($OUT[{}],TRUE,0.2)", self.plan.header.job.motion.outputs.strobe));
        source.all(&["WAIT SEC 0.6", "ENDFOR", "END"]);
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

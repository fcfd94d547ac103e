//! Where the base balls are: their CSV.

use nalgebra::Vector3;

use super::table::{MOST_BALLS, MOST_BARS};
use crate::base::table::{self, Columns};
use crate::catalogue::MeasurementFinding::{BallsNotInOrder, TooMany};
use crate::diagnostic::Diagnostic;
use crate::robot::BallId;

/// A base ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseBall {
    pub id: BallId,
    /// Its centre in the robot base, mm.
    pub position: Vector3<f64>,
}

impl BaseBall {
    /// Reads the CSV `centre,x_mm,y_mm,z_mm`: the balls in order of their numbers, which run from 1.
    ///
    /// # Errors
    /// Names the line of what is missing, not a number, or a number that is twice there or absent.
    pub fn from_csv(file: &str, text: &str) -> Result<Vec<Self>, Diagnostic> {
        let mut reader = table::reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| table::wrong_csv(file, &error))?.clone();
        let columns = Columns { file, header: &header };
        let [number, x, y, z] = columns.required(["centre", "x_mm", "y_mm", "z_mm"])?;
        let mut balls = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| table::wrong_csv(file, &error))?;
            let row = columns.row(&record);
            let position = Vector3::new(row.number(x)?, row.number(y)?, row.number(z)?);
            balls.push(Self { id: row.numbered(number)?, position });
        }
        balls.sort_by_key(|ball| ball.id);
        if balls.len() > MOST_BALLS {
            let (balls, bars, most_balls, most_bars) = (balls.len(), 1, MOST_BALLS, MOST_BARS);
            return Err(Diagnostic::file(file, TooMany { balls, bars, most_balls, most_bars }));
        }
        match balls.iter().enumerate().find(|(at, ball)| ball.id.index() != *at) {
            None => Ok(balls),
            Some((_, ball)) => Err(Diagnostic::file(file, BallsNotInOrder { ball: ball.id.number() })),
        }
    }

    /// Writes the CSV.
    pub fn to_csv(balls: &[Self]) -> String {
        let mut text = String::from("centre,x_mm,y_mm,z_mm\n");
        for Self { id, position } in balls {
            text.push_str(&format!("{id},{},{},{}\n", position.x, position.y, position.z));
        }
        text
    }
}

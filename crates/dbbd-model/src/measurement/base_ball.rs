//! The base balls and their CSV.

use nalgebra::Vector3;

use super::table::{MAX_BALLS, MAX_BARS};
use crate::base::table::TableReader;
use crate::diagnostic::Diagnostic;
use crate::measurement::MeasurementFinding::{BallsNotInOrder, NoBall, TooMany};
use crate::robot::BallId;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseBall {
    pub id: BallId,
    /// Centre in the robot base, mm.
    pub position: Vector3<f64>,
}

impl BaseBall {
    /// Reads the CSV `centre,x_mm,y_mm,z_mm`. The balls are numbered from 1 without gaps; they are returned in that order.
    pub fn from_csv(file: &str, text: &str) -> Result<Vec<Self>, Diagnostic> {
        Self::from_table(&mut TableReader::of(file, text)?)
    }

    /// Reads the base balls from a table.
    pub fn from_table(table: &mut TableReader<'_>) -> Result<Vec<Self>, Diagnostic> {
        let [number, x, y, z] = table.required(["centre", "x_mm", "y_mm", "z_mm"])?;
        let mut balls = Vec::new();
        while let Some(row) = table.row()? {
            let position = Vector3::new(row.number(x)?, row.number(y)?, row.number(z)?);
            balls.push(Self { id: row.numbered(number)?, position });
        }
        if balls.is_empty() {
            return Err(Diagnostic::file(table.file(), NoBall));
        }
        balls.sort_by_key(|ball| ball.id);
        if balls.len() > MAX_BALLS {
            let (balls, bars, most_balls, most_bars) = (balls.len(), 1, MAX_BALLS, MAX_BARS);
            return Err(Diagnostic::file(table.file(), TooMany { balls, bars, most_balls, most_bars }));
        }
        match balls.iter().enumerate().find(|(at, ball)| ball.id.index() != *at) {
            None => Ok(balls),
            Some((at, found)) => {
                let (ball, found) = (BallId::at(at).number(), found.id.number());
                Err(Diagnostic::file(table.file(), BallsNotInOrder { ball, found }))
            }
        }
    }

    pub fn to_csv(balls: &[Self]) -> String {
        let mut text = String::from("centre,x_mm,y_mm,z_mm\n");
        for Self { id, position } in balls {
            text.push_str(&format!("{id},{},{},{}\n", position.x, position.y, position.z));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_read_in_order_and_written_again() {
        let text = "centre,x_mm,y_mm,z_mm\n2,4,5,6.25\n1,1,2,-3\n";
        let balls = BaseBall::from_csv("t.csv", text).unwrap();
        assert_eq!((balls[1].id, balls[1].position), (BallId::at(1), Vector3::new(4.0, 5.0, 6.25)));
        assert_eq!(BaseBall::to_csv(&balls), "centre,x_mm,y_mm,z_mm\n1,1,2,-3\n2,4,5,6.25\n");
        for wrong in ["", "0,1,2,3\n", "2,1,2,3\n", "1,1,2,3\n1,4,5,6\n", "1,1,2,\n"] {
            assert!(
                BaseBall::from_csv("t.csv", &format!("centre,x_mm,y_mm,z_mm\n{wrong}")).is_err(),
                "{wrong}"
            );
        }
    }
}

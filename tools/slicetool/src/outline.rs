//! Outlines of areas of pixels.

use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Corners of pixels: pixel (i, j) lies between the corners (i, j) and (i + 1, j + 1).
pub type Corner = (i64, i64);

/// The outlines of an area: of each polygon the outer ring, anticlockwise, then its holes, clockwise; rings are closed.
pub fn polygons(area: &BTreeSet<Corner>) -> Vec<Vec<Vec<Corner>>> {
    // Edges with the area on their left, by where they begin.
    let mut edges: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    let mut edge = |from: Corner, to: Corner| edges.entry(from).or_default().push(to);
    for &(i, j) in area {
        let is_outside = |i: i64, j: i64| !area.contains(&(i, j));
        if is_outside(i, j - 1) {
            edge((i, j), (i + 1, j));
        }
        if is_outside(i + 1, j) {
            edge((i + 1, j), (i + 1, j + 1));
        }
        if is_outside(i, j + 1) {
            edge((i + 1, j + 1), (i, j + 1));
        }
        if is_outside(i - 1, j) {
            edge((i, j + 1), (i, j));
        }
    }
    let (mut outer, mut holes): (Vec<Vec<Vec<Corner>>>, Vec<Vec<Corner>>) = (Vec::new(), Vec::new());
    while let Some((&start, _)) = edges.first_key_value() {
        let ring = ring(&mut edges, start);
        if twice_area(&ring) > 0 { outer.push(vec![ring]) } else { holes.push(ring) }
    }
    // A hole belongs to the outer ring around the pixel left of its first edge.
    let mut ring_of: HashMap<Corner, usize> = HashMap::new();
    for (number, rings) in outer.iter().enumerate() {
        fill(area, &rings[0], number, &mut ring_of);
    }
    for hole in holes {
        let ((i, j), (to_i, to_j)) = (hole[0], hole[1]);
        let (di, dj) = ((to_i - i).signum(), (to_j - j).signum());
        // The pixel on the left of a unit step from the corner.
        let pixel = match (di, dj) {
            (1, _) => (i, j),
            (-1, _) => (i - 1, j - 1),
            (_, 1) => (i - 1, j),
            _ => (i, j - 1),
        };
        if let Some(own) = ring_of.get(&pixel) {
            outer[*own].push(hole);
        }
    }
    outer
}

/// Takes the edges of one ring, and leaves out corners on straight lines.
fn ring(edges: &mut BTreeMap<Corner, Vec<Corner>>, start: Corner) -> Vec<Corner> {
    let (mut ring, mut at, mut heading) = (vec![start], start, None::<Corner>);
    while let Some(next) = edges.get_mut(&at) {
        // Where two pixels touch at a corner: left, so that rings do not cross.
        let left = heading.and_then(|(di, dj)| next.iter().position(|to| (to.0 - at.0, to.1 - at.1) == (-dj, di)));
        let to = next.swap_remove(left.unwrap_or(0));
        if next.is_empty() {
            edges.remove(&at);
        }
        let own = (to.0 - at.0, to.1 - at.1);
        if heading == Some(own) {
            ring.pop();
        }
        ring.push(to);
        (at, heading) = (to, Some(own));
        if at == start {
            break;
        }
    }
    ring
}

fn twice_area(ring: &[Corner]) -> i64 {
    ring.windows(2)
        .map(|pair| {
            (pair[0].0 - ring[0].0) * (pair[1].1 - ring[0].1) - (pair[1].0 - ring[0].0) * (pair[0].1 - ring[0].1)
        })
        .sum()
}

/// Marks the pixels of `area` that hang together (along edges) with those inside of the first edge of `ring`.
fn fill(area: &BTreeSet<Corner>, ring: &[Corner], number: usize, ring_of: &mut HashMap<Corner, usize>) {
    // The ring begins at its lowest corner on the left, so the pixel there is inside.
    let mut open = vec![ring[0]];
    while let Some((i, j)) = open.pop() {
        if area.contains(&(i, j)) && ring_of.insert((i, j), number).is_none() {
            open.extend([(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(rows: &[&str]) -> BTreeSet<Corner> {
        let pixel = |(j, row): (usize, &&str)| {
            let found = row.bytes().enumerate().filter(|(_, byte)| *byte == b'#');
            found.map(|(i, _)| (i as i64, j as i64)).collect::<Vec<_>>()
        };
        rows.iter().enumerate().flat_map(|row| pixel((row.0, row.1))).collect()
    }

    #[test]
    fn outlines_hold_the_area_with_its_holes() {
        for rows in [
            &["#"][..],
            &["###", "#.#", "###"],
            &["##..", "##..", "..##", "..##"],
            &["#####", "#.#.#", "#####", "....#", "##..#"],
            &["######", "#....#", "#.##.#", "#.##.#", "#....#", "######"],
            &["####", "#..#", "##.#", "#..#", "####"],
        ] {
            let area = area(rows);
            let found = polygons(&area);
            let sum: i64 = found.iter().flatten().map(|ring| twice_area(ring)).sum();
            assert_eq!(sum, 2 * area.len() as i64, "{rows:?}: {found:?}");
            for rings in &found {
                assert!(rings.iter().all(|ring| ring.first() == ring.last() && ring.len() >= 5), "{rings:?}");
                assert!(twice_area(&rings[0]) > 0 && rings[1..].iter().all(|hole| twice_area(hole) < 0));
            }
        }
        assert_eq!(polygons(&area(&["##", "##"])), [[[(0, 0), (2, 0), (2, 2), (0, 2), (0, 0)]]]);
        assert_eq!(polygons(&area(&["###", "#.#", "###"]))[0].len(), 2);
    }
}

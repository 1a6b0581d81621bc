// Distance and speed of jogs. They outlive the jog view, which is built again at each change of the tab: a press that is meant as a
// hundredth must never become a jog that goes on.

/** Distances of a press, in mm or degrees; 0 jogs as long as the button is held. */
export const INCREMENTS = [0, 0.001, 0.01, 0.1, 1, 10] as const;

class JogChoice {
  /** Of a page that was just loaded the smallest: whoever presses has not chosen yet. */
  increment = $state<number>(INCREMENTS[1]);
  /** fraction of an axis's velocity */
  speed = $state(0.1);
}

export const jogChoice = new JogChoice();

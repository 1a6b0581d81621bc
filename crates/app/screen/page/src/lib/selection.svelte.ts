/** The program line that the operator looks at, in the list as well as in the path; 0 for none. */
class Selection {
  line = $state(0);
}

export const selection = new Selection();

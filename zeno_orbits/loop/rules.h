/* Numbers of the rules. The modules named here have the same; a test holds both together. */

/* integrators/events.py */
#define CUBIC 0.1
#define CUBIC_STEPS 4
#define HALVINGS 50
#define TINY 8.881784197001252e-16
#define DOUBLES 1e-09
#define POLISH 0.001

/* integrators/following.py */
#define LEAVES 1e-06

/* integrators/guard_net.py */
#define MOST_PIECES 4096
#define NARROWEST 5.820766091346741e-11
#define NEAR_START 0.015625
#define AGREE 0.0001

/* integrators/dop853.py */
#define EXPLICIT_SAFETY 0.9
#define EXPLICIT_SHRINK 0.2
#define EXPLICIT_GROW 8.0
#define EXPLICIT_EXPONENT -0.125

/* integrators/radau.py */
#define IMPLICIT_SAFETY 0.9
#define IMPLICIT_SHRINK 0.1
#define IMPLICIT_GROW 6.0
#define UNSOLVED 0.3

/* integrators/steps.py, integrators/flow.py */
#define FIRST_ITERATIONS 3
#define MOST_ITERATIONS 12
#define NEWTON_SHARE 0.01
#define NEWTON_FLOOR 0.001
#define SLACK 0.125
#define ROUNDED 1.7763568394002505e-15

/* integrators/automatic.py */
#define FIRST_LOOK 5
#define PATIENCE 24
#define HELD 3.0
#define STUCK 1.0
#define PAYS 25.0
#define LONG_LEFT 60.0
#define FIRST_STEP 2.5

/* simulation/small_hops.py */
#define HOP_PART 1e-05
#define PART_OF_HOP 0.01
#define HOP_TURNS 1.05
#define HOP_LOW 1e-08
#define LOW_RISING 1e-06

/* simulation/stop_run.py */
#define HOP_BRIEF 1e-12
#define ABOVE 1e-06
#define STEADY 1e-09

/* simulation/arc_follower.py */
#define FIRST_PACE 25000
#define RISE 1.5
#define BRIEF 0.001

/* simulation/event_rules.py */
#define INSIDE 1e-09
#define MAY_BEND 0.1
#define ROUNDING 8.881784197001252e-16
#define LATE 4.0

/* simulation/zeno_limit.py */
#define N_NODES 5
#define NODE_RATIO 0.5
#define FALLEN 8.673617379884035e-19
#define MOST_FALLS 100000

/* simulation/completion.py */
#define FIRST_TRY 6
#define WORTHWHILE 100
#define STILL_HOLDS 0.2

/* simulation/zeno_passage.py */
#define DIFFERENCES 4
#define SEEN 3e-14
#define SMOOTH 0.01
#define DECAYED 1e-12
#define WORTH_WAITING 150

/* simulation/rescaled_flight.py */
#define FLIGHT_STEPS 1000
#define MOST_CORRECTIONS 10
#define CLOSE 1e-07

/* model/contact.py */
#define SLOWEST 1.142987391282275e-100

/* model/friction.py */
#define FORCED 2.0
#define PER_PART 5

/* model/numeric/graph_dynamics.py */
#define SWITCH_ZERO 1e-12

/* model/numeric/own_scale.py */
#define START_OFF 1e-09

/* simulation/reference_run.py */
#define APART 1e-11
#define AT_ONCE 8.881784197001252e-16
#define OF_FLIGHT 1e-06
#define CONTINUOUS 1e-06
#define ONE_SURFACE 1e-06
#define SHIFT 1e-06
#define SAME 1e-09
#define GROW 4.0
#define SHORTEST 0.001
#define SPENT 1000.0
#define LEAST_IMPULSE 1e-12
#define PART_BEFORE 1e-09
#define NEAR_KINK 1000000.0
#define SPLIT 1e-08
#define SPLIT_RESOLVED 0.0001
#define SLOW_BESIDE 1e-07
#define LEAST_BESIDE 1e-10
#define ACCUMULATED 0.001
#define LOW 1e-09
#define SLOW 3e-05
#define LOST 1e-05
#define COUPLED 1e-12
#define LEFT_GAP 4.0

/* simulation/accumulations.py */
#define IN_TURN 16
#define IN_ROW 7
#define LAST_IMPACTS 6
#define CHANGES 3
#define CORNER 1e-06
#define SHORT 1e-05
#define FAST 0.2
#define SOON 0.001
#define COMPARED 4
#define FALLING 0.9
#define ALIKE 0.1

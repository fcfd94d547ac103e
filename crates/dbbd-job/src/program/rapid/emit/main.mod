MODULE DBB_MAIN
{% for line in plan.made %}
{{ line }}
{% endfor %}
  ! ball-bar calibration, plan {{ plan.hash }}, robot {{ plan.robot }}
  PROC main()
{% for module in modules %}
{% if not loop.first and not module.stays %}
    TPWrite "take the ball bar off now, then press start";
    Stop;
{% endif %}
    {{ module.name }}_RUN;
{% endfor %}
  ENDPROC
ENDMODULE
